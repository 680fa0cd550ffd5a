"""Parameters of linear structures under forces that nobody measured, from the spectra of their sensors."""

"""Modes within a band, found in the spectra of a measured force and of the sensors."""

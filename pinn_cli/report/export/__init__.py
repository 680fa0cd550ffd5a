"""The estimated response in files of other programs, beside ``response.nc``: ``report.export=[csv,mat,uff]``."""

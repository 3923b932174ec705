"""Images, calibrations and tables of other programs, read to be written as a log: files in, plain values out."""

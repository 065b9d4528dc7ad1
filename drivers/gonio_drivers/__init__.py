"""Drivers of the goniometer, polarizer and spectrometer hardware."""

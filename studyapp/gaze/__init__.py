"""Gaze: calibration, validation, fixation control."""

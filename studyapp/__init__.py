"""The lab: display, presenter, devices, session log, command line."""

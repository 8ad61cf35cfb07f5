"""Response boxes and eye trackers: decoders, readers in their own process, emulators."""

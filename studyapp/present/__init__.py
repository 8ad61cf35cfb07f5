"""Presenting: layouts, playlists, uploads, the frame loop."""

"""Displays: each flips and says when."""

"""Procedural scenes, one file each; SCENES maps a name to its builder."""

"""Temporally dense ray tracing (Andersson et al. 2019)."""

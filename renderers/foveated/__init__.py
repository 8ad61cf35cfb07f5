"""Foveated ray tracing with reprojection (Weier et al. 2016)."""

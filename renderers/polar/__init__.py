"""Polar foveated ray tracing: the Human Eye Resolution Ray Tracer (Peuhkurinen and Mikkonen, GRAPP 2021)."""

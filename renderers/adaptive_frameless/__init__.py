"""Adaptive frameless rendering (Dayal et al. 2005), and traditional frameless rendering as its baseline."""

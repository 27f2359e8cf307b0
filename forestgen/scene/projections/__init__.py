"""Projections of cameras that come with forestgen: one file each, and what several share."""

"""Environments: what a circle of a community gets from all the others, one model of competition a module."""

"""Data sets in bulk: a recipe's images made by many workers, each image once, whole or not at all."""

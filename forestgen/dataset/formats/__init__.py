"""Formats for those who train and measure: a module each, with a class of `DatasetFormat` and its only object, FORMAT.

A format is added by such a module and a line of `forestgen.recipe.registries`, or from another package by
``fg.register("dataset_format", "voc", "my_package.voc:FORMAT")``.

``write_frame`` writes the frame's own share into its folder, the shard. ``merge`` reads the shards of all frames, in
the order of their names, and writes the data set's files once. So many workers may write frames, and nobody rewrites a
file as images come. `format.py` has what most formats need for both.
"""

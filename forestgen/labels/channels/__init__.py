"""Label channels: what `labels.channels` of a recipe adds to the masks."""

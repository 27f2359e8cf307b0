"""What a site's ground offers to plants, from its height alone: elevation, slope, moisture, wind and sun."""

"""What a site's ground offers to plants, from its height alone: elevation, slope, moisture, wind and sun.

`living_conditions` is what a recipe says and what the models ask; `rasters` has the values on any grid; `drainage`
makes moisture of a `relief`, `horizons` wind, `sunshine` sun.
"""

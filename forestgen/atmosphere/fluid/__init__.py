"""Moving air: winds, heat and water on a grid (see `air`)."""

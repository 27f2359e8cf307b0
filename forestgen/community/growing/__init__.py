"""Parts of `models/kernel_growth`: what standing plants do to a place, and where seeds fall."""

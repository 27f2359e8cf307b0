"""Water on and in the soil, and vegetation that lives on it alone (docs/adr/0012-ecoclimates.md)."""

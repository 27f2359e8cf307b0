"""What `import forestgen` offers: each name there is defined in a module here, or in the layer that owns it."""

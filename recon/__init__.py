"""From transients to what is behind the corner. The only room that imports torch."""

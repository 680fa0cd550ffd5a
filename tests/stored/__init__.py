"""Small runs of every scheme as each release left them, in a zip archive for each: what later releases must read."""

"""Side-by-side timing of the project's solver and of its peers on the same mathematical programs."""

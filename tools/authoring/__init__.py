"""Code that authors the sources of the built-in verbs."""

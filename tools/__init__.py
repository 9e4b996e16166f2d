"""Programs that author and generate: sources of the built-in verbs, generated files."""

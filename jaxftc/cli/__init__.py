"""The command line. Modules here import JAX only when a command runs, so that help is quick."""

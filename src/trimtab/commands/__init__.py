"""Verbs (subcommands) of the command line, one module each. A module is imported only when its verb runs."""

"""Subcommands of the command line, one module for each subcommand. A module is imported only when it is needed."""

"""Verbs (subcommands) of the command line, one module for each verb. A module is imported only when its verb runs."""

"""Implementation of the verbs of the command line; each is imported only when it runs."""

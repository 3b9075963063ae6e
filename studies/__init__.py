"""Publications computed again: one folder a study, one file in it a group of its figures."""

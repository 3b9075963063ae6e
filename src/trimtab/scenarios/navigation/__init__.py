"""Navigation alone: the thesis's rotating platform, and a vehicle at rest."""

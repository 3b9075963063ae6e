"""Navigation by itself: the rotating platform of the source, and a vehicle at rest."""

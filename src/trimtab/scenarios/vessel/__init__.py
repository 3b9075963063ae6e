"""A surface vessel with rudders and screws: along a path."""

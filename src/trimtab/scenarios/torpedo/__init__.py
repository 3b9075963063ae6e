"""An underwater vehicle with fins and a propeller: depth and heading."""

"""trimtab: guidance, navigation and control of vehicles that are hard to steer."""

__version__ = "0.1.0"

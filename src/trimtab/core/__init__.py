"""Records, messages, interfaces, time, random numbers and mathematics that all other modules of the package use."""

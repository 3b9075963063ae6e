"""Templates of `trimtab new`: for each kind of part (e.g. a sensor), a working example with a test and a docs page."""

"""Templates of `trimtab new`: for each kind of part, a working part, its test and its docs page. All are tested."""

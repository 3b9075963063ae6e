"""Templates of `trimtab new`: for each kind of part, a part that flies, its test and its page. All are tested as is."""

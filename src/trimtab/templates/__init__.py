"""Templates of `trimtab new`: for each kind a part that flies, its test and its page, tested here unchanged."""

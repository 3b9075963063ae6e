"""What `trimtab new` writes: for each kind a part that flies, its test and its page, tested here as they are."""

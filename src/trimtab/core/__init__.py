"""Vocabulary: records, messages, interfaces, time, random numbers and the mathematics that all parts share."""

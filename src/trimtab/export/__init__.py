"""Compiled flight: the loop as C, built with the machine's own compiler and kept between runs."""

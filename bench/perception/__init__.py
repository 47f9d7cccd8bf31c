"""Held-out RGB-D sequences of the die in a hand, and what pose backends make of them."""

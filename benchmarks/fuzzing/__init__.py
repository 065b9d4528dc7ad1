"""Random and mutated bytes for every parser, in virtual time: what `benchmarks/fuzz.py` and
`tests/properties` share.
"""

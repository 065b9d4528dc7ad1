"""The wire front ends: each speaks its instrument's bytes over the same bench."""

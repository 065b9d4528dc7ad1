"""The simulated ARTA: one virtual optical bench behind wire front ends."""

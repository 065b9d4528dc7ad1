"""What `benchmarks/kill.py` is made of: lives of a scan that end at random instants, and what they leave."""

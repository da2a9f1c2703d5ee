"""From the pixels of an edge to its profile: where it runs, its noise, its light, and what the bins
hold.
"""

"""Surface temperatures: layered slabs under sun, sky, air and neighbours, with the weather of a
day.
"""

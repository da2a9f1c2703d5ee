"""Report of a session as one self-contained HTML file, with a comparison to the truth where it is
known.
"""

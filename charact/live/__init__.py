"""Live view and quick results during an acquisition; read-only, no tube or camera setting is
changed.
"""

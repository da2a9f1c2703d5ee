"""Our pictures of radiance beside a path tracer's: the same scenes, the same light, error against
time.
"""

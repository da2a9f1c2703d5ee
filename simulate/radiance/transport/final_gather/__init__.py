"""What places gather of the hemisphere around them: the sky that is open, what hides it, and what stands there.

Gathering does not ask what the sky sends, for that is known without obstacles: it asks what obstacles change. A ray
that meets nothing adds nothing, so that a place in the open has its exact light with no noise; a ray that meets an
object adds what the object sends and takes away the sky behind it. Where little of the sky is open it is the other way
round, see `Points.known`.
"""

"""The model of the rig: radiance of a scene, the intensified camera that sees it, and virtual instruments."""

from labdata.loops import keep_loops

keep_loops()

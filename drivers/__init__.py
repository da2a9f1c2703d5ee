"""The rig: gate and gain instruments, cameras, and acquisition that leaves the tube safe."""

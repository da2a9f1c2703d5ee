"""The camera at video rate: pulses drawn from tables on a coarse lattice whose noise is matched to the fine one."""

"""What a solve tells beside the interface: the surface displaced, and the stresses within."""

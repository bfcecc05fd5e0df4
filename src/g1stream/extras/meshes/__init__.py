"""The meshes of a URDF, or of the real G1, for viewers and videos."""

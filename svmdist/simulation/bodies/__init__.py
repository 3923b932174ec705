"""What stands in the scene, as meshes and textures: instrument, tag plate, organ and its relief."""

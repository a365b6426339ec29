"""The physics: meshes, springs, scenes and form-finding."""

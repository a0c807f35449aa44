"""Files: scenes as XML, meshes as PLY."""

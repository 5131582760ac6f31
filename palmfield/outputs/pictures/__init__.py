"""Pictures of a result, one kind a function: `palmfield plot` takes their names from the registry."""

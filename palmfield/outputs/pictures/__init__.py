"""Pictures of a result, one function for each kind. `palmfield plot` reads their names from the registry."""

"""Triangle meshes of vehicles, people and what stands beside a road."""

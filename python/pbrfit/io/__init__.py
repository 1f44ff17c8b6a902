"""Files to arrays and back: linear pictures, maps, JSON, output that is whole or absent."""

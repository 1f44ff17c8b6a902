"""From one photograph to a scene folder: pictures, normals and segments by neural networks.

Optional: nothing else in pbrfit needs it, and importing it loads no network library.
"""

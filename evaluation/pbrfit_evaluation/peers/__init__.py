"""Networks that find materials in one picture, beside our fit of all pictures.

A peer is not given what the fit is given: it sees one picture and neither normals nor other light.
What it has instead is what it learnt. So this is no race; it says what several pictures are worth.
The pictures have noise, and normals are as an estimator gives them: from exact input the fit would
recover scenes of its own model to the last digit, and nothing would have been compared.
"""

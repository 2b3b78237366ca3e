"""One tick of the controller: the paper's cascade, and the field's standard methods that it is measured against."""

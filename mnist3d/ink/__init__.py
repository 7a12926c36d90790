"""The ink in images of digits: grey levels, photographs, binarisation and cleaning."""

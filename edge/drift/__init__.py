"""Does the running twin still agree with the box? A sequential test on its innovations."""

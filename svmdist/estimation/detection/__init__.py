"""What images show, found by one piece of code each for all methods, and computed once per frame."""

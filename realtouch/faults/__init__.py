"""What is wrong with recordings: rules over pictures, poses and times, and what they found."""

"""What a learnt policy sees and what it can do: the same tables in training and on the rig."""

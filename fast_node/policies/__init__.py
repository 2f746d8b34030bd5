"""What may drive: everything here turns the policy input into preferences over the five meta-actions."""

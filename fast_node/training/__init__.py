"""Learning the policy. The only part of the fast system that imports torch.

To be read in this order: `network` (the policy and its value), `learner` (one update), `rollout` (the scenes behind the
mask) and `train` (the loop; the paper's equations and our departures are listed there). `baselines` stands beside them.
"""

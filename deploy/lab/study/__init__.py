"""`fastslow study`: the paper's comparison with evidence. Our learner beside PPO, DQN and A2C, many seeds each."""

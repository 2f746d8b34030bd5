"""What mask, policy, prompt and metrics mean by the same word: the road, distances, features, reward, intent."""

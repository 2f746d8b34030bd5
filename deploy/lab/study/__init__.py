"""`fastslow study`: the paper's comparison with evidence. Our learner beside four others, many seeds each."""

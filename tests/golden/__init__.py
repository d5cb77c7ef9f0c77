"""Files written by released versions, which every later one reads."""

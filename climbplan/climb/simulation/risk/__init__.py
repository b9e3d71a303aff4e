"""Plans that fall with at most a stated probability: plan, judge, ask for more where they fell."""

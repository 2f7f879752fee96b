"""The options of the verbs, in groups that several verbs share."""

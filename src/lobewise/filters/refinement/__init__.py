"""The refining network: convolutions that predict the weights of a pyramid of filters."""

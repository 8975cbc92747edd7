//! The arm's side of a PickCell.

"""Plants as graphs of branch modules: prototypes, plant types, and the arrays that community and plants share."""

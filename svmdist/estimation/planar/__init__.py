"""The planar methods: the paper's equations, the mapping fitted to a scene, and detection of the pasted marker."""

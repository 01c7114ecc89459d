"""Controllers on the same courses: paired runs, rates and means with 95 % intervals;
`soil-env evaluate`.
"""

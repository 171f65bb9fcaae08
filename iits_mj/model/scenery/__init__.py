"""Visual road scenery: surface, structures, landscape and trees."""

// Twins of lobes.py: one reflectance for a whole material. Its numbers: three diffuse, three specular, then the shape.
#include "../brdf/analytic.glsl"

// Ma et al. 2004, eq. 2, which is not the Phong of analytic.glsl.
vec3 phong_of_half(vec3 diffuse, vec3 specular, vec3 shape, vec3 light, vec3 view) {
  return diffuse * light.z + specular * power(half_vector(light, view).z, exp(shape.x));
}

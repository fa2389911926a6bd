#version 430
in vec2 parameter;
flat in int patch_number;

// u, v, patch number (exact below 2^24), window depth
out vec4 sample_;

void main() {
    sample_ = vec4(parameter, float(patch_number), gl_FragCoord.z);
}

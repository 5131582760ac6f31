from .layer_oracle import centre_response as centre_response
from .layer_oracle import centre_responses as centre_responses
from .layer_oracle import layer_compliance as layer_compliance
from .mach import mach_half_angle as mach_half_angle

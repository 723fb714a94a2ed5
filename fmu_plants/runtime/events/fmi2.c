/* FMI 2.0 for FMUs that read their resources: the same functions, of which instantiation hands on where those are. */
#include "resources.h"

#define instance_create(type, name, token, logging_on, logger, function) \
    instance_create_with_resources(type, name, token, logging_on, logger, fmuResourceLocation, function)

#include "fmi2_functions.h"

#undef instance_create

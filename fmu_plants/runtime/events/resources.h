/* Instances of FMUs that read their resources. */
#ifndef RESOURCES_H
#define RESOURCES_H

#include "instance.h"

/* As `instance_create`, with the tables of the plant read from the folder of the resources: its path, or a URI. */
Instance *instance_create_with_resources(InterfaceType type, const char *name, const char *token, bool logging_on,
                                         Logger logger, const char *location, const char *function);

#endif

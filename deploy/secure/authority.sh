#!/bin/sh
# A test authority and its certificates, for a car that is reached from other hosts:
#
#   sh deploy/secure/authority.sh FOLDER [HOST...]
#
# HOST: by which names or addresses the car is reached, beside localhost. The common name of a certificate is the role of
# whoever shows it: passenger, operator, recorder, or a node that stands in for ours (sim, fast, slow). Whoever has ca.key
# may make more. It is for trying things out: a fleet has an authority of its own.
set -eu
umask 077
[ $# -ge 1 ] || { echo "usage: authority.sh FOLDER [HOST...]" >&2; exit 2; }
command -v openssl > /dev/null || { echo "authority.sh: openssl is missing: install it" >&2; exit 69; }
folder=$1
shift
mkdir -p "$folder"
cd "$folder"
days=30
names="DNS:localhost,IP:127.0.0.1,IP:::1"
for host in "$@"; do
    case $host in
        *[!0-9.]*) case $host in *:*) names="$names,IP:$host" ;; *) names="$names,DNS:$host" ;; esac ;;
        *) names="$names,IP:$host" ;;
    esac
done

key() { openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1.key" 2> /dev/null; }

[ -e ca.key ] || {
    key ca
    openssl req -x509 -new -key ca.key -days "$days" -subj "/CN=fastslow test authority" -out ca.pem \
        -addext "basicConstraints=critical,CA:TRUE,pathlen:0" -addext "keyUsage=critical,keyCertSign"
}

certificate() { # NAME USAGE
    key "$1"
    printf 'basicConstraints=CA:FALSE\nkeyUsage=digitalSignature\nextendedKeyUsage=%s\nsubjectAltName=%s\n' \
        "$2" "$([ "$1" = door ] && echo "$names" || echo "DNS:$1")" > "$1.ext"
    openssl req -new -key "$1.key" -subj "/CN=$1" |
        openssl x509 -req -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" -extfile "$1.ext" -out "$1.pem" 2> /dev/null
    rm "$1.ext"
}

certificate door serverAuth
for role in passenger operator recorder sim fast slow; do certificate "$role" clientAuth; done
rm -f ca.srl
echo "certificates for $names in $(pwd), for $days days"
